from tautline.effects.kind import Kind, Parameter

EFFECTS = (
    Kind(
        "transmission.rest_dependent_backlash",
        (Parameter("rest_width", "unit", 5e-3, low=0.0),),
        (
            Parameter("rest_time", "s", 1.0, (0.2, 2.0), low=0.02, high=60.0),
            Parameter("rest_travel", "unit", 0.05, (0.02, 0.08), low=1e-3),
            Parameter("rest_pressed", "", 0.5, (0.5,), low=0.0, high=2.0),
        ),
        says="the width grows while the tip rests",
        material=True,
        tell="The first reversal after a long rest is wider than one without a rest, and so is a start the same way.",
        mend="Move the instrument through its range before use, or lubricate the tendon.",
    ),
)
