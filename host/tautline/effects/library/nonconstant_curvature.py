from tautline.effects.kind import Kind, Parameter

EFFECTS = (
    Kind(
        "kinematics.nonconstant_curvature",
        (Parameter("curvature_gradient", "", 0.2, low=-0.95, high=0.95),),
        says="the bending section is curved more at one end",
        needs="camera",
        leaves="plane",
    ),
)
