"""Robot description, its presets, and the two lattices on which a robot plans."""
