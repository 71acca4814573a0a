"""Chapter 6: elasticity and recognition."""
