"""The commands of `hdsp`: maps from files, contents of files, plans.

- `map_commands`: `hdsp map` and `hdsp info`; `map_file_commands`, `cloud_commands`: their parts for maps and clouds
- `plan_command`: `hdsp plan`
"""
