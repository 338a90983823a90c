"""The command line's verbs as functions of the same names, where no other package holds them."""
