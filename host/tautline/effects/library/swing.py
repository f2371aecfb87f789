from tautline.effects.kind import Kind, Parameter

EFFECTS = (
    Kind(
        "configuration.swing",
        (Parameter("swing_share", "", 0.1, low=0.0, high=1.0),),
        (
            Parameter("swing_period", "s", 0.3, (0.3, 0.6, 1.0, 1.7), low=0.05, high=10.0),
            Parameter("swing_damping", "", 0.1, (0.1,), low=0.01, high=0.95),
            Parameter("swing_carried", "", 0.5, (0.5,), low=0.0, high=2.0),
        ),
        says="the tip swings after it is moved",
        material=True,  # stiffness and damping of a tip go with its posture
        tell="After fast moves the tip rings with a period of its own.",
        mend="Accelerate more gently, or wait until it has died away.",
    ),
)
