"""What is shown of a run: figures, pages to zoom and turn, films, pictures of scenes."""
