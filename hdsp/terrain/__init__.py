"""Terrain: height maps from files, scans, sensors and random scenes, and the cost maps computed from them."""
