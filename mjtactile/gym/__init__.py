"""A Gymnasium environment of the grasp. Importing this module registers it:

gymnasium.make("mjtactile.gym:mjtactile/Grasp-v0", object="egg")
"""

try:
    import gymnasium
except ModuleNotFoundError as missing:
    if missing.name != "gymnasium":
        raise
    # omit the first half of the traceback: it has no useful information
    raise ModuleNotFoundError(
        "Gymnasium is not installed: pip install 'mjtactile[gym]'", name="gymnasium"
    ) from None

ID = "mjtactile/Grasp-v0"

if ID not in gymnasium.registry:
    gymnasium.register(
        ID,
        entry_point="mjtactile.gym.env:GraspEnv",
        vector_entry_point="mjtactile.gym.vector:make_vector",
    )
