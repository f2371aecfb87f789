"""Another degree of freedom, or another joint of the robot, that moves the bending angle through its own backlash."""

from tautline.effects.kind import FREEDOMS, Kind, Parameter

_TRANSLATION, _ROTATION = FREEDOMS
_BEFORE = Parameter("coupled_before", "", 1.0, (0.0, 1.0), searched=True)
_ID, _SAYS = "configuration.axis_coupling", "another degree of freedom moves the bending angle"


def _of_joint(column: str) -> Kind:
    """The descriptor for another joint of the same robot whose angle, through a backlash of its own, moves the bending
    angle. column: the joint's column of motor.csv."""
    return Kind(
        _ID,
        (Parameter("c_per_joint", "deg", 0.05),),
        (Parameter("joint_play", "", 1.0, (0.0, 2.0), low=0.0), _BEFORE),
        says=_SAYS,
        undone=True,
        needs="joint",
        column=column,
    )


EFFECTS = (
    Kind(
        _ID,
        (
            Parameter("c_per_translation", "deg/mm", 0.2, follows=_TRANSLATION),
            Parameter("c_per_rotation", "deg/deg", 0.02, follows=_ROTATION),
        ),
        (  # prior: an instrument slips in its drive and its channel by some mm and some ten deg
            Parameter("translation_play", "mm", 1.0, (0.0, 4.0), low=0.0, follows=_TRANSLATION),
            Parameter("rotation_play", "deg", 5.0, (0.0, 20.0), low=0.0, follows=_ROTATION),
            _BEFORE,
        ),
        says=_SAYS,
        undone=True,
        tell="The gap goes with another axis' position, with the bending motor at rest too.",
        mend="Measure with the other axes at rest, or keep their columns in motor.csv so that the model has them.",
        needs="freedom",
        of_joint=_of_joint,
    ),
)
