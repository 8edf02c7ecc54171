"""Problems whose steps follow from one another in time, or in a history of the material."""
