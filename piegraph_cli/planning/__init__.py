"""Planning strokes to a goal: costs, proposals by contact, the cross-entropy method, the MPC loop, episodes."""
