"""Chapter 4: navigation."""
