from tautline.effects.kind import Event, Kind, Parameter

EFFECTS = (
    Kind(
        "acquisition.held_samples",
        (Parameter("held_share", "", 0.1, searched=True),),
        says="the sensor repeats its values",
        tell="Values repeat while the motor moves on.",
        mend="Let the tracker or sensor say when it has no new value (valid = 0).",
        event=Event("held_share", cause="the sensor's link", what="repeated values"),
        law=True,
        leaves="time",
    ),
)
