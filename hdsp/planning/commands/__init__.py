"""The commands of `hdsp`: maps from files, contents of files, plans.

- `command_parser`, `console`: short errors, shell completion; texts, JSON and progress of all commands
- `map_commands`, `info_command`: `hdsp map`, `hdsp info`; `map_file_commands`, `cloud_commands`: parts of both
- `plan_command`, `plan_options`: `hdsp plan`; `json_documents`: JSON documents of all commands
- `view_command`: `hdsp view` and `hdsp demo`
- `completion_command`: `hdsp completion`
"""
