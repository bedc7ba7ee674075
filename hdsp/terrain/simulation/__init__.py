"""Simulated arenas: physics, lidar, the height maps it gives, and checks of plans against the true geometry.

MuJoCo (the optional dependency ``simulation``) is imported when a world is built, not before.
"""
