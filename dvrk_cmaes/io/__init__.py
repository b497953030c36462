"""Files at the edge of the program: cameras, readings and images in, results out.

Nothing further in touches a file. Readers raise ``InputError`` with one line: the file, the field, what was expected.
"""
