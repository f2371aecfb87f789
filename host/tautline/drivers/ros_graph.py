"""A node of our own on a ROS 2 graph, in a context of its own, whose callbacks a thread runs.

Unless the user's environment says otherwise only nodes of this machine are found, and find it: a motor's set-points are
nobody else's. Any ROS 2 with rclpy will do, that of the package index or one whose set-up was sourced.
"""

from __future__ import annotations

import importlib
import os
import threading
import warnings
from collections.abc import Sequence
from typing import Any

from tautline.closable import Closable
from tautline.errors import TautError

EXTRA = "pip install 'tautline-robotics[ros]'"
_RANGE, _HERE = "ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST"


def library(module: str) -> Any:
    """Imports a module of ROS 2, such as "rclpy.qos", when it is needed, as ROS 2 is optional. TautError, which says
    how to get it, where it is missing."""
    try:
        with warnings.catch_warnings():  # its messages' parser imports what Python deprecates
            warnings.simplefilter("ignore", DeprecationWarning)
            importlib.import_module("rosidl_generator_py")
            return importlib.import_module(module)
    except ImportError as error:
        raise TautError(f"ROS 2 ({module}) is not here: source its set-up, or run '{EXTRA}'") from error


def sensor_qos(depth: int = 10) -> Any:
    """Returns the QoS profile of a subscription that takes messages of publishers of any reliability. depth: messages
    that its queue holds; where several publish on one topic it needs room for all, or their messages displace each
    other."""
    qos = library("rclpy.qos")
    return qos.QoSProfile(depth=depth, reliability=qos.ReliabilityPolicy.BEST_EFFORT)


class Graph(Closable):
    """A context manager of one ROS 2 node. Publishers may be used from any thread; callbacks run on a thread of their
    own."""

    def __init__(self, name: str, arguments: Sequence[str] = ()) -> None:
        """Makes the node `name` in a context of its own. arguments: ROS 2's own, from --ros-args on (names that are
        remapped, parameters). TautError where ROS 2 does not accept them."""
        os.environ.setdefault(_RANGE, _HERE)
        self._rclpy = library("rclpy")
        executors = library("rclpy.executors")
        self._context = self._rclpy.Context()
        try:
            self._context.init(args=["taut", *arguments])
            self.node = self._rclpy.create_node(name, context=self._context)
        except Exception as error:  # a kind of its own for each thing that may be wrong with a name or an argument
            self._context.try_shutdown()
            what = " ".join(str(error).split())[:200]
            raise TautError(
                f"ROS 2 does not start a node with {' '.join(arguments) or 'its defaults'}: {what}"
            ) from error
        self._executor = executors.SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        # By which its thread ends: an executor that is shut down destroys what would wake one that waits.
        self._ended = library("rclpy.task").Future()
        self._thread: threading.Thread | None = None

    @property
    def name(self) -> str:
        """The node's full name, with its namespace."""
        return str(self.node.get_fully_qualified_name())

    def topic(self, name: str) -> str:
        """Returns the full name of a topic on the graph, after namespace and remapping."""
        return str(self.node.resolve_topic_name(name))

    def age_s(self, stamp: Any) -> float:
        """Returns the seconds from a message's stamp (sec, nanosec) until now by the node's clock; meaningless, and
        perhaps negative, where the sender has another clock."""
        return float(1e-9 * self.node.get_clock().now().nanoseconds - (stamp.sec + 1e-9 * stamp.nanosec))

    def begin(self) -> None:
        """Starts the thread that runs the callbacks. Call it after all subscriptions are made."""
        spin = self._executor.spin_until_future_complete
        self._thread = threading.Thread(target=spin, args=(self._ended,), name="ros", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Ends the thread of the callbacks and takes the node off the graph."""
        self._ended.set_result(None)
        if self._thread is not None:
            self._thread.join()
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()
