"""Planning while the hand moves: committed motions that always end at rest, and the loop that renews them (D86)."""
