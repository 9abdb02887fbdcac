"""Touch in somebody else's MuJoCo scene: `attach` a sensor, `bind` it to the compiled model,
`step`, read `touch`."""
