"""A run seen, stopped and jogged from another process, through small files in its folder (docs/panel.md)."""
