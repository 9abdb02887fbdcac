"""A sensor at run time, whatever its sheet is: a mesh in MuJoCo's model, or a film beside it."""

from mjtactile.sim.sensor.film_sensor import FilmSensor
from mjtactile.sim.sensor.runtime import TactileSensor

AnySensor = TactileSensor | FilmSensor
