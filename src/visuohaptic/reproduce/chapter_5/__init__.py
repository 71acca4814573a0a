"""Chapter 5: reconstruction."""
