"""Tactile sensors in a user's MuJoCo scene.

`attach` adds a sensor to the spec, `bind` connects it to the compiled model. `step` advances the
scene, and `touch` holds the newest estimate.
"""
