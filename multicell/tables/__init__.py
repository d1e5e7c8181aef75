"""Tables that come from outside: text of CSV files, columns of several sources, their titles."""
