"""Examples of use, each to be run by itself."""
