"""The parts of scripts/make_site.py: pages that are made when the site is built, and the check of its links."""
