"""One sensor in MuJoCo: membrane, chamber, gas, valve; what is refused and flagged."""
