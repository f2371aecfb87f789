from tautline.effects.kind import Kind, Parameter

EFFECTS = (
    Kind(
        "kinematics.nonconstant_curvature",
        (  # equation: friction takes exp(-mu c) of a tendon's pull along the section: it bends less, the more the more
            Parameter("curvature_gradient", "", 0.2, low=-0.95, high=0.95),
            Parameter("curvature_by_bend", "", 0.2, low=-0.95, high=0.95),
        ),
        says="the bending section is curved more at one end",
        tell="The marker leaves its track in the image at large angles, also where c is right.",
        mend="Calibrate f_remain with this section; check bending_length_mm.",
        needs="camera",
        leaves="plane",
    ),
)
