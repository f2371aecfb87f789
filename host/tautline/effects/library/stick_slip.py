from tautline.effects.kind import Event, Kind, Parameter

EFFECTS = (
    Kind(
        "transmission.stick_slip",
        (Parameter("stick", "unit", 5e-3, searched=True), Parameter("mean_stick_lag", "unit", 5e-3, low=0.0)),
        says="the tip moves in jumps",
        material=True,
        tell="At low speed the tip rests and jumps, never at the same place twice; drive faster and it goes.",
        mend="Clean or replace the sheath, lubricate the tendon, avoid very low speeds.",
        event=Event("stick", "mean_stick_lag", "friction along the transmission", "jumps"),
    ),
)
