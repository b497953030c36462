"""Made sessions with known truth, of the variety that laboratories have; drawn without the package's silhouettes."""
