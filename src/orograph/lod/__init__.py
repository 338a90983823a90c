"""Level of detail: methods that select what is drawn, one file or package per published method.

All have one face (``lod.method.Method``), and ``lod.registry`` knows them by name.
"""
