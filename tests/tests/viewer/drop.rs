//! What a file manager does when a file is dropped into a window: the source of XDND, version 5.

use std::path::Path;
use std::time::{Duration, Instant};

use x11rb::connection::Connection as _;
use x11rb::protocol::Event;
use x11rb::protocol::xproto::{
    Atom, AtomEnum, ClientMessageEvent, ConnectionExt as _, CreateWindowAux, EventMask, PropMode,
    SELECTION_NOTIFY_EVENT, SelectionNotifyEvent, SelectionRequestEvent, WindowClass,
};
use x11rb::rust_connection::RustConnection;
use x11rb::wrapper::ConnectionExt as _;

/// Longest that the window may take to answer.
const PATIENCE: Duration = Duration::from_secs(60);
/// Version of the protocol, in the place where it is told.
const VERSION: u32 = 5 << 24;

/// Drags a file over the window and lets go of it there. Whether the window took it.
pub fn file(display: &str, window: u32, path: &Path) -> bool {
    let (connection, screen) = x11rb::connect(Some(display)).unwrap();
    let source = Source::new(&connection, screen, window, path);
    let [enter, position, drop] = ["XdndEnter", "XdndPosition", "XdndDrop"].map(|n| atom(&connection, n));
    source.tell(enter, [VERSION, source.kind, 0, 0]);
    let center = 100 << 16 | 100;
    source.tell(position, [0, center, x11rb::CURRENT_TIME, atom(&connection, "XdndActionCopy")]);
    // It asks for the names while the pointer is over it.
    let mut asked = false;
    let status = source.answer("XdndStatus", &mut asked);
    assert_eq!(status[1] & 1, 1, "the window takes files");
    while !asked {
        source.serve(&mut asked);
    }
    source.tell(drop, [0, x11rb::CURRENT_TIME, 0, 0]);
    source.answer("XdndFinished", &mut asked)[1] & 1 == 1
}

fn atom(connection: &RustConnection, name: &str) -> Atom {
    connection.intern_atom(false, name.as_bytes()).unwrap().reply().unwrap().atom
}

struct Source<'a> {
    connection: &'a RustConnection,
    own: u32,
    window: u32,
    /// `text/uri-list`.
    kind: Atom,
    list: String,
    until: Instant,
}

impl<'a> Source<'a> {
    fn new(connection: &'a RustConnection, screen: usize, window: u32, path: &Path) -> Self {
        let root = connection.setup().roots[screen].root;
        let own = connection.generate_id().unwrap();
        let (class, depth) = (WindowClass::INPUT_ONLY, 0);
        connection.create_window(depth, own, root, 0, 0, 1, 1, 0, class, 0, &CreateWindowAux::new()).unwrap();
        let selection = atom(connection, "XdndSelection");
        connection.set_selection_owner(own, selection, x11rb::CURRENT_TIME).unwrap();
        let list = format!("file://{}\r\n", path.display());
        let kind = atom(connection, "text/uri-list");
        Self { connection, own, window, kind, list, until: Instant::now() + PATIENCE }
    }

    /// Sends a message to the window: who we are, then this.
    fn tell(&self, kind: Atom, rest: [u32; 4]) {
        let data = [self.own, rest[0], rest[1], rest[2], rest[3]];
        let message = ClientMessageEvent::new(32, self.window, kind, data);
        self.connection.send_event(false, self.window, EventMask::NO_EVENT, message).unwrap();
        self.connection.flush().unwrap();
    }

    /// Waits for a message of the window, and answers what it asks until then.
    fn answer(&self, name: &str, asked: &mut bool) -> [u32; 5] {
        let wanted = atom(self.connection, name);
        loop {
            if let Some(Event::ClientMessage(message)) = self.serve(asked)
                && message.type_ == wanted
            {
                return message.data.as_data32();
            }
        }
    }

    /// Waits for an event; gives the list of names when it asks for that.
    fn serve(&self, asked: &mut bool) -> Option<Event> {
        let event = self.connection.poll_for_event().unwrap();
        match &event {
            Some(Event::SelectionRequest(request)) => {
                self.give(request);
                *asked = true;
            }
            Some(_) => {}
            None => {
                assert!(Instant::now() < self.until, "the window does not answer");
                std::thread::sleep(Duration::from_millis(5));
            }
        }
        event
    }

    fn give(&self, request: &SelectionRequestEvent) {
        let fits = request.target == self.kind;
        let property = if fits { request.property } else { AtomEnum::NONE.into() };
        if fits {
            let (to, kind) = (request.requestor, self.kind);
            self.connection.change_property8(PropMode::REPLACE, to, property, kind, self.list.as_bytes()).unwrap();
        }
        let notify = SelectionNotifyEvent {
            response_type: SELECTION_NOTIFY_EVENT,
            sequence: 0,
            time: request.time,
            requestor: request.requestor,
            selection: request.selection,
            target: request.target,
            property,
        };
        self.connection.send_event(false, request.requestor, EventMask::NO_EVENT, notify).unwrap();
        self.connection.flush().unwrap();
    }
}
