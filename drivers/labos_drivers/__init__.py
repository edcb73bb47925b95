"""The instruments that come with LabOS, one package each."""
