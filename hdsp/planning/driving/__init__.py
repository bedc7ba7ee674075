"""Plans driven in physics: a robot made from its file follows a motion in MuJoCo.

- `drive`: `drive`, a motion on its true ground, watched and recorded
- `driven_run`: `Run`, the verdict with all states
- `robot_model`, `ground_model`: robot and ground as MJCF
- `simulated_robot`: robot and ground in MuJoCo
- `follower`: the controller; `reference`, its motion; `contact_forces`, its quadratic programme; `pose_estimate`
- `drive_film`: a drive as GIF or MP4

MuJoCo and quadprog, the optional dependency ``simulation``, load when a robot drives.
"""
