"""An unknown object, touched here and there until its surface is known (docs/how-to/explore.md)."""
