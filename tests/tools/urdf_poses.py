"""Where another reader (yourdfpy) has the tip of URDFs at given joint positions.

Standard input: a JSON list of {"file", "base", "tip", "poses": [{joint: rad or m}]}. Standard output: for each, the 4 x 4 matrices of the tip in the
base, row by row, one a pose. Joints that are not named stay where they are; those with a <mimic> follow.
"""

import json
import sys

import yourdfpy

answers = []
for question in json.load(sys.stdin):
    robot = yourdfpy.URDF.load(question["file"], load_meshes=False, build_scene_graph=True)
    matrices = []
    for pose in question["poses"]:
        robot.update_cfg(pose)
        matrix = robot.get_transform(question["tip"], question["base"])
        matrices.append([float(x) for x in matrix.reshape(-1)])
    answers.append(matrices)
json.dump(answers, sys.stdout)
