from tautline.effects.kind import Event, Kind, Parameter

EFFECTS = (
    Kind(
        "acquisition.jitter",
        (Parameter("jitter", "s", 0.005, searched=True),),
        says="frame times are unsteady",
        tell="Frames scatter along the track while the tip moves, and not at rest.",
        mend="Take the hardware's times of frames or values, or fix the camera's rate and exposure.",
        needs="sensor",
        event=Event("jitter", cause="the sensor's timing", what="unsteady times"),
        law=True,
        leaves="time",
    ),
)
