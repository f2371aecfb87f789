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
        undone=True,
        needs="load",
    ),
)
