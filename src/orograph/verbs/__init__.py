"""What the command line can do as functions of the same names, for those whose room is none of the others."""
