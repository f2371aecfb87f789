from tautline.effects.kind import Event, Kind, Parameter

EFFECTS = (
    Kind(
        "acquisition.jitter",
        (Parameter("jitter", "s", 0.005, searched=True),),
        says="frame times are unsteady",
        needs="camera",
        event=Event("jitter", cause="camera timing", what="unsteady times"),
        law=True,
        leaves="time",
    ),
)
