"""piegraph: learn how an object moves from RGB-D recordings of a person handling it, and plan with what was learned."""

__version__ = "0.1.0"
