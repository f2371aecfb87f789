from tautline.effects.kind import Kind, Parameter

EFFECTS = (
    Kind(
        "acquisition.clock_rate",
        (Parameter("clock_rate", "s/s", 2e-4),),
        says="the sensor's clock runs at another rate than the motor's",
        tell="The delay that fits grows along the recording.",
        mend="Take both times from one clock.",
        law=True,
    ),
)
