"""Simulated arenas: physics, lidar scans, height maps made from the scans, and their accuracy.

MuJoCo (the optional dependency ``simulation``) is first imported when a world is built.
"""
