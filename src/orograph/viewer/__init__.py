"""The window: navigation, panels, measuring; and the notebook's widget.

- ``pose``, ``navigation``, ``glide``, ``flying``, ``navigator``: camera movement; float64, without GUI.
- ``bookmarks``: views kept for a terrain in the user's config folder.
- ``window``, ``panels/``, ``overlay``, ``plan``, ``tools``: everything on the screen.
- ``notebook``: the same in a cell.
"""
