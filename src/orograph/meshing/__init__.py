"""TINs within a bound in metres."""
