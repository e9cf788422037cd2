"""Who may see, who may drive, what is believed, and when everything goes to rest."""
