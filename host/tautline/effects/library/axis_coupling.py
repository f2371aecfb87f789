from tautline.effects.kind import Kind, Parameter

EFFECTS = (
    Kind(
        "configuration.axis_coupling",
        (Parameter("c_per_translation", "deg/mm", 0.2), Parameter("c_per_rotation", "deg/deg", 0.02)),
        says="another degree of freedom moves the bending angle",
        needs="freedom",
    ),
)
