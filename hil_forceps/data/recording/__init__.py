"""The project's own recording of a run: its format, its writer and its reader."""
