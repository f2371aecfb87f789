from tautline.effects.kind import Kind, Parameter

EFFECTS = (
    Kind(
        "kinematics.nonconstant_curvature",
        (  # equation: friction leaves exp(-mu c) of a tendon's pull at the end of a section that is bent by c
            Parameter("curvature_gradient", "", 0.2, low=-0.95, high=0.95),
            Parameter("curvature_by_bend", "1/rad", 0.2, low=-0.95, high=0.95),
        ),
        says="the bending section is curved more at one end",
        tell="The marker leaves its track in the image at large angles, also where c is right.",
        mend="Calibrate f_remain with this section; check bending_length_mm.",
        needs="camera",
        leaves="plane",
    ),
)
