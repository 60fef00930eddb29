"""The channel: what an antenna hears of a tag. Makes the data; estimators never import it."""
