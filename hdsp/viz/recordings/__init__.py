"""Motion recordings: MCAP for Foxglove and other viewers, ROS 2 bags, animations.

- `recording_formats`: the formats, for ``Motion.save`` and ``Motion.animate``
- `track`: states at regular times with all part poses
- `mcap_recording`: terrain, path, robot, frames and states as MCAP, by foxglove-sdk
- `ros_bag`: path, trajectories, joint states and frames as a ROS 2 bag, by rosbags
- `animation`, `robot_mesh`, `z_buffer`: a motion as GIF or MP4, drawn with a depth buffer
- `film_settings`: speed, picture rate and size of animations
"""
