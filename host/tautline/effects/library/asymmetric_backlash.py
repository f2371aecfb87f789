from tautline.effects.kind import Kind, Parameter

EFFECTS = (
    Kind(
        "transmission.asymmetric_backlash",
        (Parameter("asymmetry", "unit", 5e-3, one_way=True),),
        (
            Parameter("asymmetry_travel", "unit", 0.05, (0.01, 0.03, 0.08, 0.2), low=1e-3),
            Parameter("asymmetry_form", "", 1.0, (1.0, 2.0), low=0.5, high=4.0),
            Parameter("asymmetry_renewed", "", 1.0, (0.0, 1.0), searched=True),
            Parameter("asymmetry_pressed", "", 0.5, (0.5,), low=0.0, high=2.0),
        ),
        says="after turning one way the tip starts late and catches up",
        material=True,
        brings=("transmission.backlash",),  # what holds the tip on one side widens the play too
        undone=True,
        tell="Reversals one way show their onset later than those the other way, then the tip catches up; a B(q) that "
        "is only wide does the same to both.",
        mend="Look at what guides the tendon on one side only: a pulley, a spring, a loose clamp.",
    ),
)
