"""The parts of the method ``triangle-patches``.

shape      a patch: its lattice, its triangles, and the row of numbers that says where one lies
tables     what decides about patches: errors over whole patches, saturated so that geomorphs follow each other
selection  the kernel that goes down the DAG of patch diamonds and writes the patches of a view
"""
