//! Request ids: a retried mutation gets the first one's answer, and the same id with other content is refused.

use std::collections::{HashMap, VecDeque};

use crate::error::{Code, ServiceError, shorten};

/// What was answered to recent request ids.
#[derive(Debug)]
pub struct Answers {
    /// Request id to content and answer.
    known: HashMap<String, (String, String)>,
    /// Oldest first.
    order: VecDeque<String>,
    capacity: usize,
}

impl Answers {
    /// Remembers the last `capacity` answers.
    pub fn new(capacity: usize) -> Self {
        Self { known: HashMap::new(), order: VecDeque::new(), capacity }
    }

    /// The answer given to `request_id` before, if any.
    ///
    /// # Errors
    /// `AlreadyExists` if it came with other content.
    pub fn find(&self, request_id: &str, content: &str) -> Result<Option<&str>, ServiceError> {
        match self.known.get(request_id) {
            Some((known, _)) if known != content => Err(conflict(request_id)),
            Some((_, answer)) => Ok(Some(answer)),
            None => Ok(None),
        }
    }

    /// Remembers an answer; an empty request id is not one.
    pub fn remember(&mut self, request_id: &str, content: &str, answer: &str) {
        if request_id.is_empty() {
            return;
        }
        let entry = (content.to_owned(), answer.to_owned());
        if self.known.insert(request_id.to_owned(), entry).is_none() {
            self.order.push_back(request_id.to_owned());
        }
        if self.order.len() > self.capacity
            && let Some(oldest) = self.order.pop_front()
        {
            self.known.remove(&oldest);
        }
    }
}

fn conflict(request_id: &str) -> ServiceError {
    ServiceError::new(Code::AlreadyExists, "").at(
        "request_id",
        format!("`{}` named a request with other content before; choose a new one", shorten(request_id)),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_retry_is_recognised_and_other_content_refused() {
        let mut answers = Answers::new(2);
        answers.remember("a", "content", "answer");
        assert_eq!(answers.find("a", "content").unwrap(), Some("answer"));
        assert_eq!(answers.find("a", "other").unwrap_err().code, Code::AlreadyExists);
        assert_eq!(answers.find("b", "content").unwrap(), None);
    }

    #[test]
    fn only_the_last_ones_are_remembered_and_the_empty_id_never() {
        let mut answers = Answers::new(2);
        for id in ["", "a", "b", "c"] {
            answers.remember(id, "content", id);
        }
        assert_eq!(answers.find("", "other").unwrap(), None);
        assert_eq!(answers.find("a", "other").unwrap(), None);
        assert_eq!(answers.find("b", "content").unwrap(), Some("b"));
    }
}
