"""Motors of other makers on their own buses: drives behind one interface, and the board's application over them."""
