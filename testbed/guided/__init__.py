"""A person who is guided: how they walk, what their reader hears on the way, what they are told, and what came of it."""
