"""What calls return: tables of pairs, contacts, and the arrays of launches."""
