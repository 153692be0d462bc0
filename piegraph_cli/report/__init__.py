"""Pictures of every stage of a run."""
