"""Reading and writing of files: JSON, YAML, TOML, CSV, XML, headers of images, and atomic writing.

Readers raise ``InputError`` with a message of one line that names the file, the field and what was expected.
"""
