"""Type of a sensor at run time: its membrane is a mesh in MuJoCo's model or a quasi-static
membrane."""

from mjtactile.sim.sensor.mesh_sensor import TactileSensor
from mjtactile.sim.sensor.quasistatic_sensor import QuasistaticSensor

AnySensor = TactileSensor | QuasistaticSensor
