"""taut ros MODEL"""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import click

from tautline.cli._common import (
    NumberRange,
    emit,
    force_option,
    json_option,
    log,
    refuse_unusable,
    rig_option,
    warn,
    warn_tracked_alone,
)
from tautline.cli._live import (
    LiveOptions,
    at_option,
    axis_option,
    board_option,
    camera_option,
    colour_option,
    opened_setup,
    tracking_text,
)
from tautline.model import Model


@click.command("ros", context_settings={"ignore_unknown_options": True})
@click.argument("model_path", metavar="MODEL", type=click.Path(path_type=Path))
@click.argument("ros_arguments", metavar="[ROS...]", nargs=-1, type=click.UNPROCESSED)
@board_option
@axis_option
@camera_option
@colour_option
@rig_option
@at_option
@click.option("--duration", type=NumberRange(min=0.1), help="s; default until Ctrl-C ends it.")
@click.option(
    "--ros-args", "of_ros", is_flag=True, help="Behind it stand ROS' own arguments, -r NAME:=NAME, -p NAME:=VALUE."
)
@force_option
@json_option
def command(
    model_path: Path,
    ros_arguments: tuple[str, ...],
    board: str | None,
    axis: int,
    camera: str | None,
    colour: Path,
    rig_path: Path | None,
    at: float | None,
    duration: float | None,
    of_ros: bool,
    force: bool,
    as_json: bool,
) -> None:
    """A node of ROS 2: set-points of the tip from a topic, through MODEL's tables, to one axis; its states come back.

    servo_jp (JointState, rad) is subscribed; joint_states, measured_js, setpoint_js, motor/setpoint_js and /diagnostics
    are published, with --camera tracked_js and tracked_px too, and the tables then follow what is learnt. Parameters
    are joints, command_joints, update_rate and cmd_timeout.

    Where set-points stop for longer than cmd_timeout the motor comes to rest; Ctrl-C ends with the motor off.
    """
    from tautline.drivers.ros_graph import Graph
    from tautline.live.in_use import Following, TableMover, load_tables, tracking_beside
    from tautline.ros.node import Node
    from tautline.ros.parameters import Parameters

    if ros_arguments and not of_ros:
        raise click.UsageError(f"No such option or argument: {ros_arguments[0]} (ROS' own stand behind --ros-args)")
    model = Model.load(model_path)
    refuse_unusable(model, model_path, force)
    options = LiveOptions(board=board, axis=axis, camera=camera, colour=colour, simulate=None, at=at)
    following = None
    with ExitStack() as stack:
        ended = stack.enter_context(_end_condition(duration))
        graph = stack.enter_context(Graph("tautline", ["--ros-args", *ros_arguments] if of_ros else []))
        parameters = Parameters.of(graph.node)
        live = stack.enter_context(opened_setup(options, rig_path, model=model))
        load_tables(live.board, axis, model)
        node = Node(graph, parameters, live, model)
        if camera is not None:
            warn_tracked_alone(model)
            follows = Following(live, model, mover=TableMover(live), shown=lambda frame, _: node.saw(frame))
            following = stack.enter_context(tracking_beside(follows))
        log(f"taut: the node {graph.name} waits for set-points on {graph.topic('servo_jp')}")
        result = node.run(ended, following)
    tracking = None if following is None else following.summary()
    if following is not None and (following.lost or following.beyond):
        warn(following.lost or following.beyond)
    text = _counts_in_words(result)
    emit(result | {"tracking": tracking}, as_json, text if tracking is None else f"{text}; {tracking_text(tracking)}")


@contextmanager
def _end_condition(duration_s: float | None) -> Iterator[Callable[[], bool]]:
    """A context that yields a function which returns whether the node shall end: whether SIGINT (Ctrl-C) or SIGTERM
    came, or duration_s, s, is over (None: never). Within the context these signals do nothing else, so that they take
    effect between two messages; at its end their earlier handlers are restored."""
    came = False
    began = time.monotonic()

    def stop(number: int, frame: object) -> None:
        """The signals' handler: notes that one came."""
        nonlocal came
        came = True

    before = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: came or (duration_s is not None and time.monotonic() - began >= duration_s)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _counts_in_words(result: dict[str, Any]) -> str:
    """The counts that Node.run returned as a line: set-points sent and received, unusable messages, silences,
    refusals."""
    return (
        f"{result['sent']} set-points in {result['seconds']:.1f} s of {result['received']} that came, "
        f"{result['unusable']} without the joint, {result['silences']} silences, {result['refused']} refused"
    )
