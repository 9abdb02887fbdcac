"""One sensor in MuJoCo: membrane, chamber, gas, valve; checks that reject or flag invalid
states."""
