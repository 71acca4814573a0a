"""Chapter 3: force from foam and beam."""
