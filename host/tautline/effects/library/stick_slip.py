from tautline.effects.kind import Event, Kind, Parameter

EFFECTS = (
    Kind(
        "transmission.stick_slip",
        (Parameter("stick", "unit", 5e-3, searched=True), Parameter("held_back", "unit", 5e-3, low=0.0)),
        says="the tip moves in jumps",
        event=Event("stick", "held_back", "friction along the transmission", "jumps"),
    ),
)
