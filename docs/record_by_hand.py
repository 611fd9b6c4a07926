#!/usr/bin/env python3
"""Records a laser tracker session as a file that calibrig reads: an example to start your own program from.

    pip install mcap mcap-protobuf-support
    python3 record_by_hand.py ANY_CALIBRIG_RECORDING.mcap NEW_RECORDING.mcap

The message types are taken from the first recording, since every recording carries them; other languages compile calibrig.proto. Which
topics there are is in formats.md. Here robot and tracker are two functions: an arm whose upper arm is 0.8 mm longer than its table says.
"""

import math
import sys

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader
from mcap_protobuf.writer import Writer

# What the maker says of the robot. A URDF, if the table names one, is attached as urdf/NAME.
ROBOT = """schema = "calibrig.robot/1"
name = "arm with three joints"
convention = "craig"
actuators = { kind = "direct" }

[[joint]]
name = "waist"
type = "revolute"
a_mm = 0.0
alpha_deg = 0.0
d_mm = 400.0
theta_deg = 0.0
min_deg = -150.0
max_deg = 150.0

[[joint]]
name = "shoulder"
type = "revolute"
a_mm = 0.0
alpha_deg = 90.0
d_mm = 0.0
theta_deg = 0.0
min_deg = 0.0
max_deg = 120.0

[[joint]]
name = "elbow"
type = "revolute"
a_mm = 500.0
alpha_deg = 0.0
d_mm = 0.0
theta_deg = 0.0
min_deg = -150.0
max_deg = 0.0
"""
# As drawn, in the frame of the last link, m.
TARGET = [0.370, 0.0, 0.050]
SIGMA_RANGE_M, SIGMA_ANGLE_RAD = 8e-6, 4e-6
NESTS = {"N1": (0.6, 0.5, 0.0), "N2": (-0.6, 0.5, 0.0), "N3": (-0.6, -0.5, 0.0), "N4": (0.6, -0.5, 0.1)}


def robot_moves_to(q):
    """Your robot's controller. Here: where the target really comes to lie in the base frame, m."""
    waist, shoulder, elbow = q
    both = shoulder + elbow
    radius = 0.5008 * math.cos(shoulder) + 0.371 * math.cos(both) - 0.002 * math.sin(both)
    height = 0.5008 * math.sin(shoulder) + 0.371 * math.sin(both) + 0.002 * math.cos(both)
    x = radius * math.cos(waist) + 0.050 * math.sin(waist)
    y = radius * math.sin(waist) - 0.050 * math.cos(waist)
    return x, y, 0.4 + height


def tracker_reads(point):
    """Your tracker. Here: range (m), azimuth and elevation (rad) of a point of the base, from a place 3 m beside it, turned by 0.7 rad."""
    x, y, z = point[0] - 3.0, point[1] + 0.5, point[2] - 1.2
    x, y = math.cos(0.7) * x + math.sin(0.7) * y, -math.sin(0.7) * x + math.cos(0.7) * y
    return math.sqrt(x * x + y * y + z * z), math.atan2(y, x), math.atan2(z, math.hypot(x, y))


def message_types(recording):
    """The messages of package calibrig.v1, from the schemas in a recording."""
    with open(recording, "rb") as file:
        schemas = make_reader(file).get_summary().schemas.values()
        described = next(schema.data for schema in schemas if schema.name.startswith("calibrig.v1."))
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(described).file:
        pool.Add(file)
    names = "Session", "SessionEnd", "BaseNest", "Observation"
    return [message_factory.GetMessageClass(pool.FindMessageTypeByName(f"calibrig.v1.{name}")) for name in names]


def diagonal(*variances):
    """A covariance, row by row."""
    return [variance if i == j else 0.0 for i, variance in enumerate(variances) for j in range(3)]


def read(reading, point):
    """Fills in a Reading."""
    reading.spherical.range, reading.spherical.azimuth, reading.spherical.elevation = tracker_reads(point)
    reading.spherical.covariance.extend(diagonal(SIGMA_RANGE_M**2, SIGMA_ANGLE_RAD**2, SIGMA_ANGLE_RAD**2))


def poses(count, first):
    """Commands, rad, spread evenly over the joints."""
    for i in range(first, first + count):
        at = [(0.5 + i * step) % 1.0 for step in (0.8191725134, 0.6710436067, 0.5497004779)]
        yield 4.0 * at[0] - 2.0, 1.2 * at[1] + 0.2, 1.6 * at[2] - 2.0


def main(known, new):
    Session, SessionEnd, BaseNest, Observation = message_types(known)
    with open(new, "wb") as file, Writer(file) as writer:
        # Before the messages: a file that was cut short still has it.
        writer.add_attachment(0, 0, "robot/robot.toml", "application/toml", ROBOT.encode())
        seconds = 0.0

        def write(topic, message):
            nanoseconds = round(1e9 * seconds)
            writer.write_message(topic, message, log_time=nanoseconds, publish_time=nanoseconds)

        for name, count, first in (("identification", 30, 1), ("verification", 10, 101)):
            # First what the set's observations refer to by index: stations and targets.
            session = Session(set=name)
            session.stations.add(name="beside the robot")
            session.targets.add(name="SMR", in_flange=TARGET)
            write("/session", session)
            # Optional: what ties the tracker to the base.
            for nest, place in NESTS.items():
                message = BaseNest(set=name, station=0)
                message.nest.name = nest
                message.nest.in_base.extend(place)
                message.nest.in_base_covariance.extend(diagonal(1e-10, 1e-10, 1e-10))
                read(message.nest.reading, place)
                write("/nest", message)
            for pose, q in enumerate(poses(count, first), first):
                seconds += 5.0
                observation = Observation(set=name, pose=pose, command=q, time=seconds, station=0, target=0)
                read(observation.reading, robot_moves_to(q))
                write(f"/measurement/{name}", observation)
            # Optional: without it nobody notices that the end is missing.
            write("/session/end", SessionEnd(set=name, observation_count=count))


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(*sys.argv[1:])
