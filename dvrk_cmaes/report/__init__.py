"""Reports of results: the HTML page of a session, and the picture of the shafts' axes."""
