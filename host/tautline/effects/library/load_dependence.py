from tautline.effects.kind import Kind, Parameter

EFFECTS = (
    Kind(
        "transmission.load_dependence",
        (
            Parameter("width_per_load", "1/mNm", 5e-3),
            Parameter("gain_per_load", "1/mNm", 2e-3),
            Parameter("offset_per_load", "unit/mNm", 2e-4),
        ),
        says="width, gain or offset follow the load",
        material=True,
        undone=True,
        tell="Two loads have two curves. It needs load_mNm in motor.csv, and a third load or the first one again tells "
        "it from a drift.",
        mend="Calibrate at the load of use, or at several.",
        needs="load",
    ),
)
