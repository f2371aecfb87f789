from tautline.effects.kind import Kind, Parameter

EFFECTS = (
    Kind(
        "configuration.contact",
        (Parameter("contact_hold", "", 0.3, low=0.0, high=2.0),),
        (
            Parameter("contact_c", "deg", 10.0, reached=True),
            Parameter("contact_side", "", 1.0, (1.0, -1.0), searched=True),
            Parameter("contact_soft", "deg", 2.0, (0.2, 1.0, 5.0), low=0.0),
        ),
        says="an obstacle holds the tip back beyond some bending angle",
        tell="The gap begins beyond one bending angle and has one sign.",
        mend="Free the tip of what it touches, or keep away from that angle.",
        material=True,
    ),
)
