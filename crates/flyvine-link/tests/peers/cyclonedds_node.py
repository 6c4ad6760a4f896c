"""A node of the package `cyclonedds`, with ROS 2's types written by hand: reads a flight's topics, publishes a pose of its own.

usage: cyclonedds_node.py DOMAIN

It publishes `/mocap/drone/pose` at 100 Hz from the start, and ends once it has 20 messages of every topic of the flight; the
last of each it prints as JSON.
"""

import json
import sys
import time
from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float64, int32, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
class Point(IdlStruct, typename="geometry_msgs::msg::dds_::Point_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Pose(IdlStruct, typename="geometry_msgs::msg::dds_::Pose_"):
    position: Point
    orientation: Quaternion


@dataclass
class PoseStamped(IdlStruct, typename="geometry_msgs::msg::dds_::PoseStamped_"):
    header: Header
    pose: Pose


@dataclass
class Float64(IdlStruct, typename="std_msgs::msg::dds_::Float64_"):
    data: float64


LOOPBACK = """<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="lo" multicast="true"/></Interfaces>
<AllowMulticast>true</AllowMulticast></General></Domain></CycloneDDS>"""
number = int(sys.argv[1])
domain = Domain(number, LOOPBACK)
participant = DomainParticipant(number)
# What subscriptions of ROS 2 want unless told otherwise, and what its sensors offer.
reliable = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(10))
best_effort = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(5))


def reader(topic, kind):
    return DataReader(participant, Topic(participant, "rt" + topic, kind), qos=reliable)


poses = ["/flyvine/quadrotor/pose", "/flyvine/end_effector/pose", "/flyvine/setpoint/pose"]
numbers = ["/flyvine/arm/length_m", "/flyvine/arm/pressure_kpa"]
readers = {topic: reader(topic, PoseStamped) for topic in poses} | {topic: reader(topic, Float64) for topic in numbers}
drone = DataWriter(participant, Topic(participant, "rt/mocap/drone/pose", PoseStamped), qos=best_effort)
taken = {topic: [] for topic in readers}
end = time.time() + 40.0
while time.time() < end and min(map(len, taken.values())) < 20:
    now = time.time_ns()
    header = Header(Time(now // 10**9, now % 10**9), "world")
    drone.write(PoseStamped(header, Pose(Point(1.0, 2.0, 1.5), Quaternion(0.0, 0.0, 0.6, 0.8))))
    for topic, topic_reader in readers.items():
        taken[topic] += topic_reader.take(10)
    time.sleep(0.01)


def plain(message):
    if isinstance(message, Float64):
        return message.data
    stamp, p, q = message.header.stamp, message.pose.position, message.pose.orientation
    return {
        "stamp_ns": stamp.sec * 10**9 + stamp.nanosec,
        "frame": message.header.frame_id,
        "position": [p.x, p.y, p.z],
        "attitude": [q.w, q.x, q.y, q.z],
    }


print(json.dumps({topic: plain(messages[-1]) for topic, messages in taken.items() if messages}))
