#!/usr/bin/env python3
"""Writes the fixtures of tests/fixtures/tables with programs that share nothing with calibrig.

    pip install mcap==1.6.0 rosbags==0.11.9 openpyxl==3.1.5
    python3 tests/tools/make_tables.py tests/fixtures/tables

Bags: rosbags makes the CDR of every message, the `mcap` library the container. Spreadsheet: openpyxl. What is in them is a formula that the tests
compute again.
"""

import math
import sys
from pathlib import Path

import openpyxl
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
# As the driver of a real robot has them: by the alphabet, and not along the arm.
NAMES = ["elbow", "shoulder_lift", "shoulder_pan", "wrist_1", "wrist_2", "wrist_3"]
ALONG_THE_ARM = ["shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"]
POSES = 12
START_NS = 1_700_000_000_123_456_789


def joint(pose, number):
    return 1.5 * math.sin(1.3 * pose + 0.7 * number)


def place(pose):
    return 1.0 + 0.01 * pose, -0.5 + 0.1 * math.cos(pose), 0.3 * math.sin(2.0 * pose)


class Bag:
    def __init__(self, path, kind, little=True, **options):
        self.file = open(path, "wb")
        self.writer = Writer(self.file, **options)
        self.writer.start(profile="ros2", library="make_tables.py")
        self.little = little
        self.channels = {}
        self.kind = kind

    def message(self, topic, name, content, stamp):
        if topic not in self.channels:
            schema = self.writer.register_schema(name=name, encoding="ros2msg", data=b"")
            self.channels[topic] = self.writer.register_channel(topic=topic, message_encoding="cdr", schema_id=schema)
        data = STORE.serialize_cdr(content, name, little_endian=self.little)
        # Bags are told of messages a while after they were stamped.
        self.writer.add_message(self.channels[topic], log_time=stamp + 40_000_000, publish_time=stamp, data=bytes(data))

    def header(self, stamp, frame):
        types = STORE.types
        time = types["builtin_interfaces/msg/Time"](sec=stamp // 1_000_000_000, nanosec=stamp % 1_000_000_000)
        return types["std_msgs/msg/Header"](stamp=time, frame_id=frame)

    def state(self, stamp, positions, velocities):
        import numpy
        name = "sensor_msgs/msg/JointState"
        by_name = dict(zip(ALONG_THE_ARM, zip(positions, velocities)))
        content = STORE.types[name](
            header=self.header(stamp, ""),
            name=NAMES,
            position=numpy.array([by_name[joint][0] for joint in NAMES]),
            velocity=numpy.array([by_name[joint][1] for joint in NAMES]),
            effort=numpy.array([]),
        )
        self.message("/joint_states", name, content, stamp)

    def point(self, stamp, xyz):
        types = STORE.types
        x, y, z = xyz
        if self.kind == "PointStamped":
            point = types["geometry_msgs/msg/Point"](x=x, y=y, z=z)
            content = types["geometry_msgs/msg/PointStamped"](header=self.header(stamp, "tracker"), point=point)
        else:
            turn = types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
            if self.kind == "PoseStamped":
                point = types["geometry_msgs/msg/Point"](x=x, y=y, z=z)
                pose = types["geometry_msgs/msg/Pose"](position=point, orientation=turn)
                content = types["geometry_msgs/msg/PoseStamped"](header=self.header(stamp, "tracker"), pose=pose)
            else:
                shift = types["geometry_msgs/msg/Vector3"](x=x, y=y, z=z)
                transform = types["geometry_msgs/msg/Transform"](translation=shift, rotation=turn)
                content = types["geometry_msgs/msg/TransformStamped"](
                    header=self.header(stamp, "tracker"), child_frame_id="smr", transform=transform
                )
        self.message("/tracker", f"geometry_msgs/msg/{self.kind}", content, stamp)

    def session(self):
        for pose in range(POSES):
            at = START_NS + 2_000_000_000 * pose
            for step in range(-3, 4):
                stamp = at + 10_000_000 * step
                positions = [joint(pose, number) for number in range(6)]
                velocities = [0.0] * 6
                if pose == 5:
                    # The elbow has not come to rest.
                    positions[2] += 0.001 * step
                    velocities[2] = 0.1
                self.state(stamp, positions, velocities)
                if step == 0:
                    self.point(at + 3_000_000, place(pose))
            if pose == 7:
                # Between two poses nobody said where the robot was.
                self.point(at + 1_000_000_000, (9.0, 9.0, 9.0))
        self.writer.finish()
        self.file.close()


def book(path):
    workbook = openpyxl.Workbook()
    sheet = workbook.active
    sheet.title = "Points"
    sheet["B2"] = "measured on a Tuesday"
    for column, name in enumerate(["Pose", *ALONG_THE_ARM, "X [mm]", "Y [mm]", "Z [mm]", "remark"], start=2):
        sheet.cell(row=4, column=column, value=name)
    for pose in range(POSES):
        row = [pose + 1, *(math.degrees(joint(pose, number)) for number in range(6)), *(1e3 * axis for axis in place(pose))]
        for column, value in enumerate(row, start=2):
            sheet.cell(row=5 + pose, column=column, value=value)
    sheet["L6"] = True
    workbook.create_sheet("Notes")["A1"] = "nothing of use"
    workbook.save(path)


def main(folder):
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    Bag(folder / "points_lz4.mcap", "PointStamped", compression=CompressionType.LZ4).session()
    Bag(folder / "poses_zstd_be.mcap", "PoseStamped", little=False, compression=CompressionType.ZSTD, enable_crcs=False).session()
    Bag(folder / "transforms_plain.mcap", "TransformStamped", use_chunking=False, index_types=IndexType.NONE).session()
    book(folder / "points.xlsx")


if __name__ == "__main__":
    main(*sys.argv[1:])
