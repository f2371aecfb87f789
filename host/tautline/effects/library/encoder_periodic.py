from tautline.effects.kind import Kind, Parameter

EFFECTS = (
    Kind(
        "actuator.encoder_periodic",
        tuple(Parameter(f"encoder_{name}", "unit", 2e-3) for name in ("sin", "cos", "sin2", "cos2")),
        # From the shortest to the longest: a servo's horn turns less than once. Beyond twice the range no ripple comes
        # again to be seen, and its harmonics would follow any change of f_remain.
        (Parameter("encoder_period", "unit", 0.05, (0.02, 1.5), low=1e-3, high=2.0),),
        says="once-per-turn error of the measured motor position",
        undone=True,
        tell="B(q) and the residuals ripple with one period over q, the same in both directions.",
        mend="Centre the encoder's magnet or disc and calibrate again.",
        scan="period",
    ),
)
