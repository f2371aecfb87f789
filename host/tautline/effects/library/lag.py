from tautline.effects.kind import Kind, Parameter

EFFECTS = (
    Kind(
        "transmission.lag",
        (Parameter("lag", "s", 0.02, low=0.0, high=5.0),),  # prior: longer is creep
        (
            Parameter("lag_second", "", 0.2, (0.0, 0.5), low=0.0, high=0.5),
            Parameter("lag_held", "", 1.0, (0.0, 1.0), searched=True),
        ),
        says="the tip lags, viscous, first order",
        material=True,
        undone=True,
        tell="The gap goes with speed, has its sign, and is gone when the motor rests; a wrong delay does that too, "
        "but also moves the images of other axes.",
        mend="Drive more slowly, or feed the lag forward in the controller.",
    ),
)
