"""What hangs loose in its play: between the ends nothing holds it, and it falls to the side that its load pulls to."""

from tautline.effects.kind import Kind, Parameter

EFFECTS = (
    Kind(
        "transmission.loose",
        (Parameter("loose_pull", "1/s^2", 50.0),),
        (
            Parameter("loose_place", "unit", 0.1, (0.0,)),
            Parameter("loose_drag", "1/s", 5.0, (5.0,), low=0.0),
        ),
        says="what the motor drives is loose within the backlash and falls to the side of its load",
        tell="The tip changes sides where its load does, as where an arm hangs down, and not where the motor turns.",
        mend="Take the slack out, or press the joint to one side by a spring.",
        needs="simulator",
    ),
)
