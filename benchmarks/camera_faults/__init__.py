"""What is felt when the camera is not as it was."""
