"""Tables, sentences and progress on the terminal, and the rows that documents share with them."""
