"""From a surface to a picture: the G-buffer, what writes it, and what reads it.

``gbuffer`` is the contract, ``projection`` the way between pixels and the ground, ``layered`` a surface behind what is
transparent. A backend is a package: ``cpu``.
"""
