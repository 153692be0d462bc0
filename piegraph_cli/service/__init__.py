"""A warm model that answers: plan, predict, look and info, over JSON lines or HTTP."""
