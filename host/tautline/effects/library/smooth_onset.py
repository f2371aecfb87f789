from tautline.effects.kind import Kind, Parameter

EFFECTS = (
    Kind(
        "transmission.smooth_onset",
        # 2 with a tail of 1: thresholds from nothing on, exponentially, as Dahl's friction has it.
        (Parameter("onset_spread", "", 0.2, probe=2.5, low=0.0, high=2.0),),
        (Parameter("onset_tail", "", 0.5, (0.0, 1.0), low=0.0, high=1.3),),
        says="motion starts gradually instead of at a corner",
        material=True,
        undone=True,
        brings=("transmission.backlash",),
        tell="After a reversal the tip starts slowly and reaches its slope over a way comparable to B: 'Some onsets "
        "closely' in a report shows no corner.",
        mend="Nothing is broken: several play elements hold it, or Bouc-Wen's or Dahl's friction, and calibration fits "
        "by itself what is likeliest.",
    ),
)
