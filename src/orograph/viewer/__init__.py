"""The window: navigation, panels, measuring; and the notebook's widget.

- ``pose``, ``navigation``, ``glide``, ``flying``, ``navigator``: how a camera is moved; float64, no GUI in it.
- ``bookmarks``: views kept for a terrain in the user's config folder.
- ``window``, ``panels/``, ``overlay``, ``plan``, ``tools``: what is on the screen.
- ``notebook``: the same in a cell.
"""
