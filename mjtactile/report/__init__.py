"""Reports of a run: figures, interactive pages, videos, and images of scenes."""
