"""A Gymnasium environment of the grasp. Importing this module registers it:

gymnasium.make("mjtactile.gym:mjtactile/Grasp-v0", object="egg")
"""

try:
    import gymnasium
except ModuleNotFoundError as missing:
    if missing.name != "gymnasium":
        raise
    # without the traceback's first half: there is nothing to be learned from it
    raise ModuleNotFoundError(
        "Gymnasium is not installed: pip install 'mjtactile[gym]'", name="gymnasium"
    ) from None

ID = "mjtactile/Grasp-v0"

if ID not in gymnasium.registry:
    gymnasium.register(
        ID,
        entry_point="mjtactile.gym.env:GraspEnv",
        vector_entry_point="mjtactile.gym.vector:ThreadedVectorEnv",
    )
