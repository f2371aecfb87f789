from tautline.effects.kind import Kind, Parameter

EFFECTS = (
    Kind(
        "transmission.creep",
        (Parameter("creep_share", "", 0.05, low=-1.0, high=1.0),),
        (
            # prior: longer is a drift, in use too
            Parameter("creep_time", "s", 1.0, (0.5, 1.5, 5.0), low=0.5, high=60.0),
            Parameter("creep_slow", "", 0.3, (0.0, 0.5), low=0.0, high=1.0),
        ),
        says="the tip goes on moving after the motor stops",
        material=True,
        contains=("transmission.lag",),
        brings=("configuration.remaining",),
        undone=True,
        tell="After the motor stops the tip goes on for seconds, or back where a tendon stretches under its load, and "
        "the gap shrinks while it rests; a lag is over in a fraction of a second.",
        mend="Use a stiffer tendon or sheath, or wait before a position counts.",
    ),
)
