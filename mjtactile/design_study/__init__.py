"""What a sensor file reaches, before anything is built or simulated: the film says where the
markers stand on what presses, the camera's bound how well they are seen, and the sensing chain's
own covariance what is felt of it."""
