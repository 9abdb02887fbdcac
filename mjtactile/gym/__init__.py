"""A Gymnasium environment of the grasp. Importing this module registers it:

gymnasium.make("mjtactile.gym:mjtactile/Grasp-v0", object="egg")
"""

import gymnasium

ID = "mjtactile/Grasp-v0"

if ID not in gymnasium.registry:
    gymnasium.register(ID, entry_point="mjtactile.gym.env:GraspEnv")
