"""Files of other tools: one module per tool, one neutral value between them."""
