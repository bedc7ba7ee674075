"""The viewer of `hdsp view`: plans that follow a user's changes, in a browser.

- `planning_session`: answers the latest request in threads, without any drawing
- `map_viewer`: session, scene and panel together
- `control_panel`: the controls; `map_layers`: costs, edges and searched states as colours
- `first_poses`: start and goal where a user names none
"""
