"""Reads a calibrig recording with the reader of the MCAP project for Python: every message of every topic decodes, every checksum fits, and
what the summary counts is what is there.

    pip install mcap mcap-protobuf-support
    python tests/tools/check_recording.py RECORDING.mcap
"""

import collections
import sys

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

# Every recording of a run has these; `/truth` only where it is simulated.
EXPECTED = {
    "/session": "calibrig.v1.Session",
    "/session/end": "calibrig.v1.SessionEnd",
    "/nest": "calibrig.v1.BaseNest",
    "/measurement/identification": "calibrig.v1.Observation",
    "/measurement/verification": "calibrig.v1.Observation",
    "/truth/as_built": "calibrig.v1.AsBuilt",
    "/truth/pose": "calibrig.v1.SettledPose",
    "/truth/effects": "calibrig.v1.PoseEffects",
    "/estimate/only_calibration": "calibrig.v1.Estimate",
    "/residual/only_calibration": "calibrig.v1.Residual",
    "/tf": "foxglove.FrameTransforms",
    "/tf_static": "foxglove.FrameTransforms",
    "/scene": "foxglove.SceneUpdate",
    "/scene/robot": "foxglove.SceneUpdate",
    "/targets": "foxglove.PointCloud",
    "/log": "foxglove.Log",
}


def main(path):
    counts, schemas, ended = collections.Counter(), {}, {}
    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            counts[channel.topic] += 1
            schemas[channel.topic] = schema.name
            if decoded.DESCRIPTOR.full_name != schema.name:
                sys.exit(f"{path}: {channel.topic} holds {decoded.DESCRIPTOR.full_name}, not {schema.name}")
            if channel.topic == "/session/end":
                ended[decoded.set] = decoded.observation_count
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        attachments = {record.name for record in reader.iter_attachments()}
    for topic, name in EXPECTED.items():
        if schemas.get(topic) != name:
            sys.exit(f"{path}: {topic} has the schema {schemas.get(topic)}, expected {name}")
    stated = {summary.channels[id].topic: count for id, count in summary.statistics.channel_message_counts.items()}
    if stated != dict(counts):
        sys.exit(f"{path}: the summary counts {stated}, there are {dict(counts)}")
    for name, count in ended.items():
        if counts[f"/measurement/{name}"] != count:
            sys.exit(f"{path}: {name} ends with {count} observations, there are {counts[f'/measurement/{name}']}")
    listed = set(metadata["calibrig"]["attachments"].split("\n"))
    if listed != attachments:
        sys.exit(f"{path}: the metadata name the attachments {listed}, there are {attachments}")
    print(f"{path}: {sum(counts.values())} messages on {len(counts)} topics decode, {len(attachments)} attachments")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(sys.argv[1])
