// This is a generated file! Please edit source .ksy file and use kaitai-struct-compiler to rebuild

#include "modbus_reply.h"

modbus_reply_t::modbus_reply_t(kaitai::kstream* p__io, kaitai::kstruct* p__parent, modbus_reply_t* p__root) : kaitai::kstruct(p__io) {
    m__parent = p__parent;
    m__root = p__root ? p__root : this;

    try {
        _read();
    } catch(...) {
        _clean_up();
        throw;
    }
}

void modbus_reply_t::_read() {
    m_station = m__io->read_u1();
    m_function = m__io->read_u1();
    n_pdu = true;
    switch (function()) {
    case 131: {
        n_pdu = false;
        m_pdu = new exception_t(m__io, this, m__root);
        break;
    }
    case 3: {
        n_pdu = false;
        m_pdu = new registers_t(m__io, this, m__root);
        break;
    }
    }
    m_check = m__io->read_u2le();
}

modbus_reply_t::~modbus_reply_t() {
    _clean_up();
}

void modbus_reply_t::_clean_up() {
    if (!n_pdu) {
        if (m_pdu) {
            delete m_pdu; m_pdu = 0;
        }
    }
}

modbus_reply_t::exception_t::exception_t(kaitai::kstream* p__io, modbus_reply_t* p__parent, modbus_reply_t* p__root) : kaitai::kstruct(p__io) {
    m__parent = p__parent;
    m__root = p__root;

    try {
        _read();
    } catch(...) {
        _clean_up();
        throw;
    }
}

void modbus_reply_t::exception_t::_read() {
    m_code = m__io->read_u1();
}

modbus_reply_t::exception_t::~exception_t() {
    _clean_up();
}

void modbus_reply_t::exception_t::_clean_up() {
}

modbus_reply_t::registers_t::registers_t(kaitai::kstream* p__io, modbus_reply_t* p__parent, modbus_reply_t* p__root) : kaitai::kstruct(p__io) {
    m__parent = p__parent;
    m__root = p__root;
    m_values = 0;

    try {
        _read();
    } catch(...) {
        _clean_up();
        throw;
    }
}

void modbus_reply_t::registers_t::_read() {
    m_bytes = m__io->read_u1();
    m_values = new std::vector<uint16_t>();
    const int l_values = bytes() / 2;
    for (int i = 0; i < l_values; i++) {
        m_values->push_back(m__io->read_u2be());
    }
}

modbus_reply_t::registers_t::~registers_t() {
    _clean_up();
}

void modbus_reply_t::registers_t::_clean_up() {
    if (m_values) {
        delete m_values; m_values = 0;
    }
}
