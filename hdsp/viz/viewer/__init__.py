"""Plans in three dimensions in a browser, by viser.

- `ground_mesh`, `textures`: the terrain as a mesh, and the colours of its cells
- `robot_pose`, `robot_nodes`, `timeline`: a robot's parts, their nodes in a scene, and configurations over time
- `plan_scene`, `plan_page`: a plan in the scene of a server, and as one HTML file
- `local_server`: a server for browsers on this machine

Arrays, states and motions are drawn; the viewer knows no planner. viser is loaded when a server starts.
"""

from hdsp.viz.viewer.local_server import PORT, address, open_server
from hdsp.viz.viewer.plan_scene import PlanScene
from hdsp.viz.viewer.static_page import plan_page, save_page, temporary_page

__all__ = ["PORT", "PlanScene", "address", "open_server", "plan_page", "save_page", "temporary_page"]
