"""Choice between the checks of devices and those of a simulated rig."""

from mjtactile import doctor
from mjtactile.sim import doctor as sim_doctor


def test_the_sensor_of_the_command_applies_to_a_simulated_rig(monkeypatch):
    """Its file may name no sensor, as the file of a real rig."""
    sensors = []
    monkeypatch.setattr(
        sim_doctor, "examine_simulated", lambda rig, sensor: sensors.append(sensor) or []
    )
    assert doctor.examine_rig("sim_arm", sensor="paper16") == []
    assert sensors == ["paper16"]
