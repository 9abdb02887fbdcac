"""An unknown object, touched here and there until its surface is known (docs/explore.md)."""
