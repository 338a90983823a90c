"""Level of detail: methods that select what is drawn, one file or package per published method.

All implement ``lod.method.Method``; ``lod.registry`` lists them by name.
"""
