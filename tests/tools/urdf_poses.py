"""Where another reader (yourdfpy) has the tip of URDFs at given joint positions.

Standard input: a JSON list of {"file", "base", "tip", "poses": [{joint: rad or m}]}. Standard output: for each, the 4 x 4 matrices of the tip in the
base, row by row, one a pose. Joints with a <mimic> follow.

The reader itself takes milliseconds a pose. So all poses are the product of the origins and axes that it has read, by numpy, and twenty of them
are compared with where the reader itself puts the tip.
"""

import json
import sys

import numpy as np
import yourdfpy

COMPARED = 20


def motions(joint, q):
    """4 x 4 matrices of a joint at positions q."""
    matrices = np.tile(np.eye(4), (len(q), 1, 1))
    axis = np.asarray(joint.axis, dtype=float)
    if joint.type == "prismatic":
        matrices[:, :3, 3] = q[:, None] * axis
    elif joint.type in ("revolute", "continuous"):
        x, y, z = axis / np.linalg.norm(axis)
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        sine, cosine = np.sin(q)[:, None, None], np.cos(q)[:, None, None]
        matrices[:, :3, :3] += sine * cross + (1 - cosine) * (cross @ cross)
    else:
        assert joint.type == "fixed", joint.type
    return matrices


def positions(robot, joint, poses):
    if joint.mimic is not None:
        leader = positions(robot, robot.joint_map[joint.mimic.joint], poses)
        return (1.0 if joint.mimic.multiplier is None else joint.mimic.multiplier) * leader + (joint.mimic.offset or 0.0)
    return np.array([pose.get(joint.name, 0.0) for pose in poses])


def to_root(robot, link, poses):
    """4 x 4 matrices of a link in the root of its tree."""
    above = {joint.child: joint for joint in robot.joint_map.values()}
    matrices = np.tile(np.eye(4), (len(poses), 1, 1))
    while link in above:
        joint = above[link]
        origin = np.eye(4) if joint.origin is None else joint.origin
        matrices = origin @ motions(joint, positions(robot, joint, poses)) @ matrices
        link = joint.parent
    return matrices


answers = []
for question in json.load(sys.stdin):
    robot = yourdfpy.URDF.load(question["file"], load_meshes=False, build_scene_graph=True)
    poses, base, tip = question["poses"], question["base"], question["tip"]
    matrices = np.linalg.inv(to_root(robot, base, poses)) @ to_root(robot, tip, poses)
    for pose, matrix in zip(poses[:COMPARED], matrices):
        robot.update_cfg(pose)
        assert np.abs(robot.get_transform(tip, base) - matrix).max() < 1e-12, question["file"]
    answers.append(matrices.reshape(len(poses), 16).tolist())
json.dump(answers, sys.stdout)
