"""What a scene is made of: meshes, half-spaces, copies; and the checks of what users pass in."""
