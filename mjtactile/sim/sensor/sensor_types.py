"""A sensor at run time, whatever its sheet is: a mesh in MuJoCo's model, or a film beside it."""

from mjtactile.sim.sensor.mesh_sensor import TactileSensor
from mjtactile.sim.sensor.quasistatic_sensor import QuasistaticSensor

AnySensor = TactileSensor | QuasistaticSensor
