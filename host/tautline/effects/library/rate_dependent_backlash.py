from tautline.effects.kind import Kind, Parameter

EFFECTS = (
    Kind(
        "transmission.rate_dependent_backlash",
        (Parameter("width_per_speed", "s", 0.02, low=0.0),),
        (
            Parameter("speed_saturation", "", 0.5, (0.0, 2.0), low=0.0, high=3.0),  # beyond: as wide at any speed
            Parameter("speed_time", "s", 0.02, (0.02, 0.2), low=2e-3, high=1.0),
            Parameter("width_held", "", 1.0, (0.0, 1.0), searched=True),
        ),
        says="the width grows with speed",
        material=True,
        undone=True,
        tell="The same reversal is wider when it is driven faster.",
        mend="Calibrate at the speed of use, or drive more slowly through reversals.",
    ),
)
