"""The frame monitor live in the terminal. It draws what a `LiveView` of the service layer holds, and knows no lines."""
