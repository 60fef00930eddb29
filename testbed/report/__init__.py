"""What people look at: renders, figures, the page. Computing and drawing never mix: everything here reads recordings and results."""
