"""A client of `taut ros` in a process of its own: plain rclpy, nothing of the package.

    python ros_client.py NAMESPACE OUT SECONDS

Once the node is there it sends a sine of the tip for SECONDS and then nothing more; a second after the last set-point
it writes what came to OUT/heard.json, by topic: each message's stamp, names and positions, and its bytes in hex.
"""

import json
import math
import sys
import time
from pathlib import Path

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

AMPLITUDE_RAD, PERIOD_S, STEP_S = 0.25, 3.0, 0.01
TOPICS = {
    "joint_states": JointState, "measured_js": JointState, "setpoint_js": JointState, "motor/setpoint_js": JointState,
    "tracked_js": JointState, "tracked_px": PointStamped, "/diagnostics": DiagnosticArray,
}  # fmt: skip


def row(raw, kind):
    message = deserialize_message(raw, kind)
    at = message.header.stamp
    told = {"log_ns": time.time_ns(), "stamp_ns": at.sec * 10**9 + at.nanosec, "cdr": raw.hex()}
    if kind is JointState:
        told |= {"names": list(message.name), "positions": list(message.position)}
    elif kind is PointStamped:
        told |= {"u": message.point.x, "v": message.point.y}
    else:
        for status in message.status:
            values = {each.key: each.value for each in status.values}
            told |= {"level": status.level[0], "name": status.name, "says": status.message, "values": values}
    return told


def main():
    namespace, out, seconds = sys.argv[1], Path(sys.argv[2]), float(sys.argv[3])
    rclpy.init()
    node = rclpy.create_node("client", namespace=namespace)
    heard = {topic: [] for topic in TOPICS}
    for topic, kind in TOPICS.items():
        take = lambda message, topic=topic, kind=kind: heard[topic].append(row(message, kind))  # noqa: E731
        node.create_subscription(kind, topic, take, 100, raw=True)
    sender = node.create_publisher(JointState, "servo_jp", 1)
    while not sender.get_subscription_count() or not heard["joint_states"]:
        rclpy.spin_once(node, timeout_sec=0.02)
    first = heard["joint_states"][-1]
    start = first["positions"][first["names"].index("tip")]
    message = JointState(name=["another", "tip"])
    began = due = time.monotonic()
    sent = []
    while due < began + seconds:
        wait = due - time.monotonic()
        if wait > 0.0:
            rclpy.spin_once(node, timeout_sec=wait)
            continue
        c = start + AMPLITUDE_RAD * math.sin(2.0 * math.pi * (due - began) / PERIOD_S)
        message.position = [9.0, c]
        sender.publish(message)
        sent.append({"t_ns": time.time_ns(), "c": c})
        due += STEP_S
    while time.monotonic() < due + 1.0:
        rclpy.spin_once(node, timeout_sec=0.05)
    (out / "heard.json").write_text(json.dumps({"sent": sent, "heard": heard}))
    node.destroy_node()
    rclpy.shutdown()


main()
