"""The emulated rig: loop, faults, damaged bytes."""
