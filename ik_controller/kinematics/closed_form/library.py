def library_form(screws, known): raise NotImplementedError
